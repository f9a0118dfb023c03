"""``python -m can_rig`` is ``can-rig``."""

from can_rig.cli.main import main

main()
