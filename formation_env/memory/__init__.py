"""Where each number lies: records, arrays in one piece of memory, loops over the worlds of a tile."""
