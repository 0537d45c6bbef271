"""Commands on recordings: record, replay, import, inspect, export, fit-noise."""
