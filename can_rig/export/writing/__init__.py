"""C from typed Python: expressions, statements, declarations, named numbers, and whole files."""
