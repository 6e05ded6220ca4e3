# OpenBLAS and LAPACKE factor clusters; cJSON writes the settings and errors of a bake.
find_library(PRT_OPENBLAS openblas REQUIRED)
find_library(PRT_LAPACKE lapacke REQUIRED)
target_link_libraries(prt_bake PUBLIC PkgConfig::CJSON ${PRT_LAPACKE} ${PRT_OPENBLAS})
# The bounds alone, without the libraries of a bake.
add_library(prt_bake_limits STATIC bake/limits.c)
target_include_directories(prt_bake_limits PUBLIC include)
target_link_libraries(prt_bake_limits PRIVATE prt_options)
