"""Examples that take measurements of others, by the user's own download."""
