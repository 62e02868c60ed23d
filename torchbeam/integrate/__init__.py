"""Time integration: one file a method."""
