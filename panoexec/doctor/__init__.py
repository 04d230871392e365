"""`panoexec doctor`: checks links, message rates, devices, broker and machine for a mission; changes no setting."""
