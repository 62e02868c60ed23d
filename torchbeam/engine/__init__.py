"""Native engine: local functions traced, and run on a chain as machine code."""
