"""Scores: errors, association, GOSPA, consistency, and the statistics over trials."""
