"""Losses, regularisers, schedules and the optimisation loop."""
