"""The `tam` command: a file for each subcommand, and one for those that start, feed and call the nodes."""
