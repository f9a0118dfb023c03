"""Figures of the sampled firmware over the continuous loop, of the thesis and of any plant."""
