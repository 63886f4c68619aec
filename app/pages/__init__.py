"""What the web page says: forms, what was understood, results."""
