#include "services/dds/shared_memory.h"

#include "dds/ddsi/ddsi_domaingv.h"
#include "dds/ddsi/ddsi_sertype.h"
#include "dds/features.h"

bool rips_dds_uses_shared_memory(const struct ddsi_sertype* type) {
#ifdef DDS_HAS_SHM
  const struct ddsi_domaingv* domain = ddsrt_atomic_ldvoidp(&type->gv);
  return domain->config.enable_shm != 0;
#else
  (void)type;
  return false;
#endif
}
