"""How good the reading of photographs is, where what they show is known: codes, boards, whole sessions."""
