"""The `tam` command: one file for each subcommand."""
