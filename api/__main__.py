"""`fluxtwin`, and `python -m fluxtwin`: the command line."""

import sys

from fluxtwin.sim.base.processes import nothing_left_to_stop, stop_when_asked


def main() -> int:
    """Run the command line and return its exit status; an interrupt is heeded before anything slow is imported."""
    stop_when_asked()
    from fluxtwin.cli import main as command_line

    try:
        return command_line()
    finally:
        nothing_left_to_stop()


if __name__ == "__main__":
    sys.exit(main())
