"""The mixed element of the derivation: its equations, their index-reduced rates, and the minimal form."""
