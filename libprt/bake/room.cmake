# OpenBLAS and LAPACKE factor clusters; cJSON writes the settings and errors of a bake.
# LAPACKE as an archive where there is one: its shared library loads a second LAPACK, of 10 MB, of which
# nothing is called, since OpenBLAS has all of it.
find_library(PRT_OPENBLAS openblas REQUIRED)
find_library(LAPACKE_LIBRARY NAMES liblapacke.a lapacke REQUIRED)
target_link_libraries(prt_bake PUBLIC PkgConfig::CJSON ${LAPACKE_LIBRARY} ${PRT_OPENBLAS})
# The bounds alone, without the libraries of a bake.
add_library(prt_bake_limits STATIC bake/limits.c)
target_include_directories(prt_bake_limits PUBLIC include)
target_link_libraries(prt_bake_limits PRIVATE prt_options)
