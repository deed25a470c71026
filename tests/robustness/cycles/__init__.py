"""Openings and closings in long rows, after which no process may have grown."""
