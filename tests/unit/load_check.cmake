prt_test(load_check SOURCES unit/load_check.c LIBS relightd_rooms LABELS unit)
