"""Many robots and many recordings: gathered in parallel, fitted by period, watched for drift."""
