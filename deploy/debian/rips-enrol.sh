# A renewal that is under way is short, and ends of itself.
triggers="rips-enrol-renew.timer"
