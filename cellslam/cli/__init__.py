"""The command line: a file a command, its arguments and its body. `main` finds the one that is asked for."""
