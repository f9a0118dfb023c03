"""``can-rig`` and ``python -m can_rig``."""

import os

from can_rig.cli.startup import (
    collect_nothing,
    end_at_once,
    leave_out,
    refusals_in_one_line,
    silence,
    write_what_can_be_written,
)


def main() -> None:
    """Run the command line; Ctrl-C counts from the first moment on."""
    end_at_once()
    collect_nothing()
    leave_out()
    silence()
    # The matrices are small: threads of OpenBLAS cost more than they save, and do not survive fork.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    write_what_can_be_written()
    with refusals_in_one_line():
        from can_rig.cli.main import main as commands  # noqa: PLC0415 (from here on it takes time)

        try:
            commands()
        finally:  # Python waits for the threads of a user's controller
            end_at_once()


if __name__ == "__main__":
    main()
