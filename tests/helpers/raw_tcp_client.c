/* Client of rosbridge over raw TCP in BSON, written from the specification of BSON alone (bsonspec.org, version 1.1).
 *
 * It sends what ROSIntegration and rosbridge2cpp send: ids made of operation, name and number, types as ROS 1 spells
 * them, and each document behind the other. It reads four bytes with a document's length and then its rest.
 *
 * Usage: raw_tcp_client PORT [TOKEN]
 *
 * Prints every document it receives, a line for each value: its path, its kind, and the value. It ends with 0 when it
 * has received joint states, the result of its goal and the answer to its call.
 */
#include <arpa/inet.h>
#include <inttypes.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

enum { MAX_DOCUMENT = 1 << 20, MAX_PATH = 512, TIMEOUT_S = 120 };

/* Kinds of elements. */
enum { DOUBLE = 0x01, TEXT = 0x02, DOCUMENT = 0x03, ARRAY = 0x04, BINARY = 0x05, BOOLEAN = 0x08, NOTHING = 0x0a,
       INT32 = 0x10, INT64 = 0x12 };

static void fail(const char *problem)
{
    perror(problem);
    exit(1);
}

/* Documents to send. */

typedef struct {
    uint8_t bytes[4096];
    size_t size;
} Builder;

static void put(Builder *to, const void *bytes, size_t size)
{
    if (to->size + size > sizeof to->bytes)
        exit(3);
    memcpy(to->bytes + to->size, bytes, size);
    to->size += size;
}

static void put_int32(Builder *to, int32_t value)
{
    uint32_t bits = (uint32_t)value;
    uint8_t bytes[4] = {bits & 0xff, bits >> 8 & 0xff, bits >> 16 & 0xff, bits >> 24};
    put(to, bytes, 4);
}

static void put_key(Builder *to, uint8_t kind, const char *key)
{
    put(to, &kind, 1);
    put(to, key, strlen(key) + 1);
}

static void put_text(Builder *to, const char *key, const char *value)
{
    put_key(to, TEXT, key);
    put_int32(to, (int32_t)strlen(value) + 1);
    put(to, value, strlen(value) + 1);
}

static void put_boolean(Builder *to, const char *key, uint8_t value)
{
    put_key(to, BOOLEAN, key);
    put(to, &value, 1);
}

static size_t begin(Builder *to)
{
    size_t place = to->size;
    put_int32(to, 0);
    return place;
}

static void end(Builder *to, size_t place)
{
    Builder length = {.size = 0};
    put(to, "", 1);
    put_int32(&length, (int32_t)(to->size - place));
    memcpy(to->bytes + place, length.bytes, 4);
}

static void send_bytes(int connection, const uint8_t *bytes, size_t size)
{
    while (size > 0) {
        ssize_t sent = send(connection, bytes, size, 0);
        if (sent <= 0)
            fail("send");
        bytes += sent;
        size -= (size_t)sent;
    }
}

/* Documents that come. */

typedef struct {
    const uint8_t *at;
    const uint8_t *end;
} Reader;

static const uint8_t *take(Reader *from, size_t size)
{
    const uint8_t *at = from->at;
    if ((size_t)(from->end - at) < size) {
        fprintf(stderr, "a document ends too early\n");
        exit(4);
    }
    from->at += size;
    return at;
}

static int32_t take_int32(Reader *from)
{
    const uint8_t *b = take(from, 4);
    return (int32_t)((uint32_t)b[0] | (uint32_t)b[1] << 8 | (uint32_t)b[2] << 16 | (uint32_t)b[3] << 24);
}

static int64_t take_int64(Reader *from)
{
    uint64_t low = (uint32_t)take_int32(from), high = (uint32_t)take_int32(from);
    return (int64_t)(low | high << 32);
}

static const char *take_key(Reader *from)
{
    const uint8_t *zero = memchr(from->at, 0, (size_t)(from->end - from->at));
    if (zero == NULL)
        exit(4);
    return (const char *)take(from, (size_t)(zero - from->at) + 1);
}

/* Topic and operation of the document that is printed, and what has come so far. */
static char operation[64], topic[256];
static int joint_states, results, answers;

static void print_document(Reader *from, const char *prefix)
{
    const uint8_t *begins = from->at;
    int32_t size = take_int32(from);
    Reader inside = {from->at, begins + size};
    if (size < 5 || begins + size > from->end)
        exit(4);
    from->at = begins + size;
    for (;;) {
        uint8_t kind = *take(&inside, 1);
        char path[MAX_PATH];
        if (kind == 0)
            break;
        snprintf(path, sizeof path, "%s%s%s", prefix, *prefix ? "." : "", take_key(&inside));
        if (kind == DOUBLE) {
            int64_t bits = take_int64(&inside);
            double value;
            memcpy(&value, &bits, sizeof value);
            printf("%s double %.17g\n", path, value);
        } else if (kind == TEXT) {
            int32_t length = take_int32(&inside);
            const char *value = (const char *)take(&inside, (size_t)length);
            printf("%s text %s\n", path, value);
            if (strcmp(path, "op") == 0)
                snprintf(operation, sizeof operation, "%s", value);
            if (strcmp(path, "topic") == 0)
                snprintf(topic, sizeof topic, "%s", value);
        } else if (kind == DOCUMENT || kind == ARRAY) {
            printf("%s %s\n", path, kind == ARRAY ? "array" : "document");
            print_document(&inside, path);
        } else if (kind == BINARY) {
            int32_t length = take_int32(&inside);
            take(&inside, (size_t)length + 1);
            printf("%s binary %" PRId32 "\n", path, length);
        } else if (kind == BOOLEAN) {
            printf("%s boolean %d\n", path, *take(&inside, 1));
        } else if (kind == NOTHING) {
            printf("%s null\n", path);
        } else if (kind == INT32) {
            printf("%s int32 %" PRId32 "\n", path, take_int32(&inside));
        } else if (kind == INT64) {
            printf("%s int64 %" PRId64 "\n", path, take_int64(&inside));
        } else {
            fprintf(stderr, "an element of kind %d\n", kind);
            exit(4);
        }
    }
}

static void receive_bytes(int connection, uint8_t *bytes, size_t size)
{
    while (size > 0) {
        ssize_t received = recv(connection, bytes, size, 0);
        if (received <= 0)
            fail("recv");
        bytes += received;
        size -= (size_t)received;
    }
}

static void receive_document(int connection)
{
    static uint8_t bytes[MAX_DOCUMENT];
    Reader length = {bytes, bytes + 4}, document;
    int32_t size;
    receive_bytes(connection, bytes, 4);
    size = take_int32(&length);
    if (size < 5 || size > MAX_DOCUMENT)
        exit(4);
    receive_bytes(connection, bytes + 4, (size_t)size - 4);
    document = (Reader){bytes, bytes + size};
    operation[0] = topic[0] = 0;
    printf("document %" PRId32 "\n", size);
    print_document(&document, "");
    joint_states += strcmp(topic, "/joint_states") == 0;
    results += strcmp(topic, "/moveit_goal_result") == 0;
    answers += strcmp(operation, "service_response") == 0;
}

/* The operations. */

static void subscribe(Builder *to, const char *id, const char *name, const char *type)
{
    size_t place = begin(to);
    put_text(to, "op", "subscribe");
    put_text(to, "id", id);
    put_text(to, "topic", name);
    put_text(to, "type", type);
    end(to, place);
}

int main(int count, char **arguments)
{
    Builder first = {.size = 0}, goal = {.size = 0}, call = {.size = 0};
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    struct timeval timeout = {.tv_sec = TIMEOUT_S};
    int connection = socket(AF_INET, SOCK_STREAM, 0);
    size_t place, inner, sent;
    if (count < 2)
        return 2;
    address.sin_port = htons((uint16_t)atoi(arguments[1]));
    if (connect(connection, (struct sockaddr *)&address, sizeof address) < 0)
        fail("connect");
    setsockopt(connection, SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof timeout);

    if (count > 2) {
        place = begin(&first);
        put_text(&first, "op", "auth");
        put_text(&first, "token", arguments[2]);
        end(&first, place);
    }
    subscribe(&first, "subscribe:/joint_states:1", "/joint_states", "sensor_msgs/JointState");
    subscribe(&first, "subscribe:/moveit_goal_result:2", "/moveit_goal_result", "moveit_msgs/MoveItErrorCodes");
    place = begin(&first);
    put_text(&first, "op", "advertise");
    put_text(&first, "id", "advertise:/moveit_goal_named:3");
    put_text(&first, "topic", "/moveit_goal_named");
    put_text(&first, "type", "std_msgs/String");
    put_key(&first, INT32, "queue_size");
    put_int32(&first, 10);
    put_boolean(&first, "latch", 0);
    end(&first, place);
    /* Several documents by one call of the kernel. */
    send_bytes(connection, first.bytes, first.size);

    place = begin(&goal);
    put_text(&goal, "op", "publish");
    put_text(&goal, "id", "publish:/moveit_goal_named:4");
    put_text(&goal, "topic", "/moveit_goal_named");
    put_boolean(&goal, "latch", 0);
    put_key(&goal, DOCUMENT, "msg");
    inner = begin(&goal);
    put_text(&goal, "data", "ready");
    end(&goal, inner);
    end(&goal, place);
    /* One document in pieces of a byte. */
    for (sent = 0; sent < goal.size; sent++)
        send_bytes(connection, goal.bytes + sent, 1);

    place = begin(&call);
    put_text(&call, "op", "call_service");
    put_text(&call, "id", "call_service:/rosapi/topic_type:5");
    put_text(&call, "service", "/rosapi/topic_type");
    put_key(&call, DOCUMENT, "args");
    inner = begin(&call);
    put_text(&call, "topic", "/joint_states");
    end(&call, inner);
    end(&call, place);
    send_bytes(connection, call.bytes, call.size);

    while (joint_states < 3 || results < 1 || answers < 1)
        receive_document(connection);
    close(connection);
    return 0;
}
