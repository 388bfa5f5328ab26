"""What a user may read and change between two steps."""
