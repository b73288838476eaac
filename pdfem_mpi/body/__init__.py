"""What every cell carries, and on which rank."""
