"""An FMU, the model file of another tool, as a plant: FMI 2 and 3, through FMPy.

`description` reads the file's model description and resolves the scenario's names. `unpacking` puts
the files of the FMU into a folder, within bounds. `instance` loads the FMU, `stepping` advances the
instance from tick to tick, `plant` presents the FMU as a plant class.
"""
