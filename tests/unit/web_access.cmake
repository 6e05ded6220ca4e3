prt_test(web_access SOURCES unit/web_access.c LIBS relightd_rooms LABELS unit)
