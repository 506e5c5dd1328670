"""What it runs on: libraries, variants, memory."""
