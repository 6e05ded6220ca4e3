prt_test(variant_views SOURCES unit/variant_views.c LIBS prt_media LABELS unit)
