prt_test(drain SOURCES unit/drain.c LIBS relightd_rooms LABELS unit)
