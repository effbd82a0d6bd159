"""`python -m deltaid`: the command line where no script is installed."""

from deltaid.cli import main

if __name__ == "__main__":
    main()
