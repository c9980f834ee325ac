"""The command line: `main` puts the commands together, each other file is one group of them."""
