"""Newton's method and what follows from its solution; knows no beam."""
