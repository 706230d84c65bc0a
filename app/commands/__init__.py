"""The commands of the command line, one a file; `app/cli.py` lists them."""
