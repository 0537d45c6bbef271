"""Tables: rows summed up, as text, Markdown, LaTeX, CSV and JSON."""
