"""The command line: `main` makes the parser, `commands/` has a module for each command, the others what they share."""
