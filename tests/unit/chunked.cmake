prt_test(chunked SOURCES unit/chunked.c LIBS relightd_rooms LABELS unit)
