"""Monte Carlo trials of estimators, their scores, tables and figures."""
