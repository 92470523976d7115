"""The plant: a simulated arm with its drives, wrist sensor and contacts."""
