"""Sets of drives: how they are made, described for data hubs, and checked. What they are: `scenarios.sets`."""
