"""The physical world around the boards: motion, coils, fields."""
