"""States at one instant, and solutions over time."""
