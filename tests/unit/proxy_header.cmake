prt_test(proxy_header SOURCES unit/proxy_header.c LIBS relightd_rooms LABELS unit)
