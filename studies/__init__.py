"""Studies that the commands run: accuracy, effect costs, rates, hard cases, verification."""
