"""`python -m fluxtwin`: the command line."""

import sys

from fluxtwin.cli import main

if __name__ == "__main__":
    sys.exit(main())
