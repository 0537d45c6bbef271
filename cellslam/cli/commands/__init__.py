"""A module for each command: `EXAMPLES`, `add_arguments(parser)` and `command(arguments)`, its exit status."""
