"""One filter alone, from any continuous one: run, bounded in its rounding, and as C."""
