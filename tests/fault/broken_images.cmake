prt_test(broken_images SOURCES fault/broken_images.c LIBS prt_light prt_base LABELS fault)
