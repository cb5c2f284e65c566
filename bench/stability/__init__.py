"""The benchmark of stability: every method that makes lights of moving light, on maps and sequences that anybody can make anew."""
