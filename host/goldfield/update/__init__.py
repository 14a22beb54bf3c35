"""New images for boards: the keys that sign them, the files that hold them, and their way over a link."""
