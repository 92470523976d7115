"""Contact geometry: which wrenches contacts can bear, which motions they leave free."""
