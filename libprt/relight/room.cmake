# The kernels' instruction sets are chosen at run time; each file is compiled for its own.
if(CMAKE_SYSTEM_PROCESSOR MATCHES "x86_64|AMD64")
  set_source_files_properties(relight/kernels_avx2.c relight/mixed_avx2.c PROPERTIES
    COMPILE_OPTIONS "-mavx2;-mfma;-mf16c")
  set_source_files_properties(relight/kernels_avx512.c relight/expand_avx512.c relight/mixed_avx512.c
    PROPERTIES
    COMPILE_OPTIONS "-mavx2;-mfma;-mf16c;-mavx512f;-mavx512bw;-mavx512dq;-mavx512vl;-mprfchw")
  set_source_files_properties(relight/expand_vnni.c relight/pairs_vnni.c PROPERTIES COMPILE_OPTIONS
    "-mavx2;-mfma;-mf16c;-mavx512f;-mavx512bw;-mavx512dq;-mavx512vl;-mprfchw;-mavx512vnni")
endif()
