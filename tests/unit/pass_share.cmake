prt_test(pass_share SOURCES unit/pass_share.c LIBS relightd_rooms LABELS unit)
