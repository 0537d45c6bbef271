"""A recording or an estimate as files of other tools."""
