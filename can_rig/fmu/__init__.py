"""FMUs, the model files of other tools, of FMI 2 and 3 through FMPy.

`file` reads and unpacks an FMU's file, `instance` runs the FMU. Imported by `plant` and
`controllers`.
"""
