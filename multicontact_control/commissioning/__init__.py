"""A robot of one's own: tool and contacts from measurements, the push test, gains."""
