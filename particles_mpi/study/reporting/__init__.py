"""What a study found, as tables, pictures and a page."""
