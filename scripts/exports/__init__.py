"""What check_exports.py knows of exports: their tables, and the formats that take more than a page to read."""
