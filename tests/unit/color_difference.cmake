prt_test(color_difference SOURCES unit/color_difference.c LIBS prt_formats LABELS unit)
