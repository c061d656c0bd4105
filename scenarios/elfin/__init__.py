"""ELFIN-A, 12 January 2022: a real spinner, whose boom bends between sun and shadow."""
