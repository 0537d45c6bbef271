"""A module for each command: `EXAMPLES`, `add_arguments(parser)`, and `command(arguments)`, its status (None: done)."""
