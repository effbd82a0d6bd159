"""`python -m deltaid`: the command line where no script is installed."""

import sys

from deltaid.cli import main

if __name__ == "__main__":
    sys.argv[0] = "deltaid"  # the command that pages say they were made by
    main()
