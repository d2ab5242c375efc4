"""The league: which step size learns fastest, where, and how sure that is."""
