"""Views for a person: the terminal's table, the comparison with a known truth, pictures."""
