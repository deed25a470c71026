"""The stereo demo: two cameras, depth from matched pairs, a planner and a mapper (paper, section 5: LAGR)."""
