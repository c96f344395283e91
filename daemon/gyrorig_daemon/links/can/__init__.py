"""CAN: lines that read a bus, the link to a bus, and the links to its boards."""
