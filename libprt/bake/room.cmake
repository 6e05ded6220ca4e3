# OpenBLAS and LAPACKE factor clusters; cJSON writes the settings and errors of a bake.
find_library(PRT_OPENBLAS openblas REQUIRED)
find_library(PRT_LAPACKE lapacke REQUIRED)
target_link_libraries(prt_bake PUBLIC PkgConfig::CJSON ${PRT_LAPACKE} ${PRT_OPENBLAS})
