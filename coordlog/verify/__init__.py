"""What can be proven of a file, and what can be saved of a damaged one."""
