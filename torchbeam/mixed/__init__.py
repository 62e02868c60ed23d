"""Mixed element of the derivation: residuals, index-reduced rates, minimal form."""
