"""Our field against magnetometers that really flew: MAGSAT 1980 and Swarm-A in a storm."""
