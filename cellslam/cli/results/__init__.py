"""Commands on the results of sweeps: table, consistency, figures, report."""
