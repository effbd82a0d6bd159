"""`python -m deltaid`: the command line where no script is installed."""

import sys

from deltaid.cli import main

if __name__ == "__main__":
    sys.argv[0] = "deltaid"  # pages show this command as their origin
    main()
