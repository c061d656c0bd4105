"""What every other folder stands on: errors, checked TOML, the atomic writer, random streams, kernels."""
