"""The law in C against the law in Python: any memory, any inputs, every bit of the state."""
