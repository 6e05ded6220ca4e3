prt_test(signed_url SOURCES unit/signed_url.c LIBS relightd_rooms LABELS unit)
