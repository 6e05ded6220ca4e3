prt_test(access_unit SOURCES unit/access.c LIBS relightd_rooms LABELS unit)
