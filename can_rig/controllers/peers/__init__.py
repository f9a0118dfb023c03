"""Controllers to compare the rig's own law with, each in a file that names its source.

Every class fulfils `controllers.protocol.Controller`, as a controller of one's own does.
"""
