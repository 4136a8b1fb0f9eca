"""Our sets in the hands of peers that cannot live in this environment."""
