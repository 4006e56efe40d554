"""Run the command line as ``python -m navlearn``."""

from navlearn.cli import main

if __name__ == "__main__":
    main()
