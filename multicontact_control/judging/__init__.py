"""What a run was worth: metrics, verdict, claims of the paper, figures, report."""
