"""Many robots and many recordings: factor files, fits by period, drift, types, the site."""
