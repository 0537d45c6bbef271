"""From a folder of tables and its manifest to a recording."""
