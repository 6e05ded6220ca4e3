prt_test(log SOURCES unit/log.c LIBS relightd_rooms)
