"""Quotas: how much of each port and host one caller may use, and how much it uses."""
