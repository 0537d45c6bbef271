"""Tables: rows summed up (`summaries`), as text, Markdown, LaTeX, CSV and JSON (`formats`)."""
