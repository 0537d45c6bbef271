"""Cities from files, and to them: meshes, Mitsuba scenes, CityJSON, OpenStreetMap. In: a path; out: a City."""
