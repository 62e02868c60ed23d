"""Motion: one file a method, the step by step, the whole simulation."""
