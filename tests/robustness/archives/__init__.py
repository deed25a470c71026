"""Faults of archives: kills, clean stops, full disks and flipped bits, while programs put with ack="disk"."""
