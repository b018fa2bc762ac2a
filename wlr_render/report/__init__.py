"""Reports: blocks of text, tables and figures, written as HTML, Markdown and JSON, and shown in the terminal."""
