"""Native engine: local functions traced, and run over nodes and elements as machine code."""
