"""Adapters: from the files of published campaigns to a recording."""
