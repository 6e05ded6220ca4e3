prt_test(color_kernels SOURCES kernels/colors.c LIBS prt LABELS kernels)
