"""A plant that is an FMU, a file of another tool with the model in it: FMI 2 and 3, through FMPy.

`description` reads what the file says and finds what the scenario names, `unpacking` puts its
files into a folder, within bounds, `instance` loads it, `stepping` takes it from tick to tick,
`plant` is it as the class of a plant of one's own.
"""
