#include "services/dds/domain_internals.h"

#include <string.h>

#include "dds/ddsi/ddsi_domaingv.h"
#include "dds/ddsi/ddsi_sertype.h"
#include "dds/ddsi/q_protocol.h"
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

void rips_dds_limit_linger(const struct ddsi_sertype* type, int64_t longest_ns) {
  struct ddsi_domaingv* domain = ddsrt_atomic_ldvoidp(&type->gv);
  if (domain->config.writer_linger_duration > longest_ns) {
    domain->config.writer_linger_duration = longest_ns;
  }
}

size_t rips_dds_interfaces(const struct ddsi_sertype* type, struct rips_dds_interface* into,
                           size_t max, bool* automatic) {
  const struct ddsi_domaingv* domain = ddsrt_atomic_ldvoidp(&type->gv);
  const struct ddsi_config_network_interface_listelem* wanted = domain->config.network_interfaces;
  *automatic = wanted == NULL || wanted->cfg.automatic;
  size_t count = 0;
  for (int i = 0; i < domain->n_interfaces && count < max; ++i) {
    const struct nn_interface* each = &domain->interfaces[i];
    const bool ipv6 =
        each->loc.kind == NN_LOCATOR_KIND_UDPv6 || each->loc.kind == NN_LOCATOR_KIND_TCPv6;
    const bool ipv4 =
        each->loc.kind == NN_LOCATOR_KIND_UDPv4 || each->loc.kind == NN_LOCATOR_KIND_TCPv4;
    if (!ipv4 && !ipv6) continue;
    into[count].name = each->name;
    into[count].index = each->if_index;
    into[count].ipv6 = ipv6;
    memcpy(into[count].address, each->loc.address, sizeof into[count].address);
    ++count;
  }
  return count;
}
