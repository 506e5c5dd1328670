"""The second judge: files as three.js shows them, in a headless Chromium."""
