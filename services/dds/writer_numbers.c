#include "services/dds/writer_numbers.h"

#include <stddef.h>

#include "dds/ddsi/ddsi_domaingv.h"
#include "dds/ddsi/ddsi_entity_index.h"
#include "dds/ddsi/ddsi_entity_match.h"
#include "dds/ddsi/ddsi_proxy_endpoint.h"
#include "dds/ddsi/ddsi_sertype.h"
#include "dds/ddsi/q_radmin.h"
#include "dds/ddsi/q_thread.h"
#include "dds/ddsi/q_xevent.h"
#include "dds/ddsrt/avl.h"
#include "dds/version.h"

#if DDS_VERSION_MAJOR != 0 || DDS_VERSION_MINOR != 10
#error "writer_numbers.c knows the internal interface of Cyclone DDS 0.10 only"
#endif

static uint32_t word(const uint8_t* bytes) {
  return (uint32_t)bytes[0] << 24 | (uint32_t)bytes[1] << 16 | (uint32_t)bytes[2] << 8 | bytes[3];
}

// Locked; it lives while this thread is awake. NULL if there is no such writer.
static struct ddsi_proxy_writer* lock_writer(const struct ddsi_domaingv* domain,
                                             const uint8_t* bytes) {
  ddsi_guid_t guid;
  for (int i = 0; i < 3; ++i) guid.prefix.u[i] = word(bytes + 4 * i);
  guid.entityid.u = word(bytes + 12);
  struct ddsi_proxy_writer* writer = entidx_lookup_proxy_writer_guid(domain->entity_index, &guid);
  if (writer != NULL) ddsrt_mutex_lock(&writer->e.lock);
  return writer;
}

static struct ddsi_pwr_rd_match* next_match(const struct ddsi_proxy_writer* writer,
                                            const struct ddsi_pwr_rd_match* match) {
  if (match == NULL) return ddsrt_avl_find_min(&ddsi_pwr_readers_treedef, &writer->readers);
  return ddsrt_avl_find_succ(&ddsi_pwr_readers_treedef, &writer->readers, match);
}

bool rips_dds_numbers_of(const struct ddsi_sertype* type, const uint8_t* guid,
                         struct rips_dds_numbers* numbers) {
  struct ddsi_domaingv* domain = ddsrt_atomic_ldvoidp(&type->gv);
  struct thread_state* thread = lookup_thread_state();
  thread_state_awake(thread, domain);
  struct ddsi_proxy_writer* writer = lock_writer(domain, guid);
  if (writer != NULL) {
    numbers->next = nn_reorder_next_seq(writer->reorder);
    numbers->last = writer->last_seq;
    uint64_t fragments = 0;
    nn_reorder_stats(writer->reorder, &numbers->discarded);
    nn_defrag_stats(writer->defrag, &fragments);
    numbers->discarded += fragments;
    // Readers that catch up with what the writer wrote before they came have numbers of their own.
    struct ddsi_pwr_rd_match* match = next_match(writer, NULL);
    for (; writer->n_readers_out_of_sync > 0 && match; match = next_match(writer, match)) {
      if (match->in_sync != PRMSS_OUT_OF_SYNC) continue;
      const uint64_t next = nn_reorder_next_seq(match->u.not_in_sync.reorder);
      if (next > numbers->next) numbers->next = next;
    }
    ddsrt_mutex_unlock(&writer->e.lock);
  }
  thread_state_asleep(thread);
  return writer != NULL;
}

static struct nn_reorder* new_reorder(const struct ddsi_domaingv* domain, bool reliable,
                                      uint32_t samples_max) {
  return nn_reorder_new(
      &domain->logconfig,
      reliable ? NN_REORDER_MODE_NORMAL : NN_REORDER_MODE_MONOTONICALLY_INCREASING, samples_max,
      domain->config.late_ack_mode != 0);
}

static void forget(const struct ddsi_domaingv* domain, struct ddsi_proxy_writer* writer) {
  const struct ddsi_config* config = &domain->config;
  const bool reliable = writer->c.xqos->reliability.kind == DDS_RELIABILITY_RELIABLE;
  nn_reorder_free(writer->reorder);
  writer->reorder = new_reorder(domain, reliable, config->primary_reorder_maxsamples);
  nn_defrag_free(writer->defrag);
  writer->defrag = nn_defrag_new(
      &domain->logconfig, reliable ? NN_DEFRAG_DROP_LATEST : NN_DEFRAG_DROP_OLDEST,
      reliable ? config->defrag_reliable_maxsamples : config->defrag_unreliable_maxsamples);
  // Its first sample is what we ask for; the writer sends it, or says that it is gone, and in
  // either case what it has: then the rest is asked for. (It must not be asked as at the start, for
  // then the answer would count as the end of what is old, and nothing of that would come.)
  writer->last_seq = writer->n_reliable_readers > 0 ? 1 : 0;
  writer->last_fragnum = UINT32_MAX;
  for (struct ddsi_pwr_rd_match* match = next_match(writer, NULL); match;
       match = next_match(writer, match)) {
    const bool asks = match->acknack_xevent != NULL;
    if (match->in_sync == PRMSS_OUT_OF_SYNC) {
      nn_reorder_free(match->u.not_in_sync.reorder);
      match->u.not_in_sync.reorder =
          new_reorder(domain, asks, config->secondary_reorder_maxsamples);
    }
    if (!asks) {
      // It has nothing to catch up with. (Cyclone lets it go by itself until a heartbeat, which it
      // does not look at as long as no reader is reliable.)
      if (match->in_sync != PRMSS_SYNC) --writer->n_readers_out_of_sync;
      match->in_sync = PRMSS_SYNC;
      continue;
    }
    match->last_seq = 1;
    match->last_nack = (struct last_nack_summary){0};
    match->heartbeat_since_ack = 1;
    match->ack_requested = 1;
    resched_xevent_if_earlier(match->acknack_xevent, ddsrt_time_monotonic());
  }
}

bool rips_dds_forget_numbers(const struct ddsi_sertype* type, const uint8_t* guid) {
  struct ddsi_domaingv* domain = ddsrt_atomic_ldvoidp(&type->gv);
  struct thread_state* thread = lookup_thread_state();
  thread_state_awake(thread, domain);
  struct ddsi_proxy_writer* writer = lock_writer(domain, guid);
  if (writer != NULL) {
    forget(domain, writer);
    ddsrt_mutex_unlock(&writer->e.lock);
  }
  thread_state_asleep(thread);
  return writer != NULL;
}
