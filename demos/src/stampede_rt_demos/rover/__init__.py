"""The rover demo: a stereo pair in the rover's own process, a planner that joins, a drain and a lost host (LAGR)."""
