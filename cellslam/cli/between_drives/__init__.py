"""Options of commands for what one drive leaves to the next: the array's calibration, the map."""
