"""What of a glTF file stays while some of it is fitted: its cameras and lights, and the file around new arrays."""
