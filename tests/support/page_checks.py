"""What anybody must be able to do with a page, asked of it in a browser: see its text, name its controls, hit them, not scroll sideways.

Each is a script that returns what is wrong, as text; nothing is wrong with an empty list.
"""

# Text of less than 4.5:1 (WCAG 2.2, 1.4.3; 3:1 where it is large), by the colours that the browser computed, backgrounds blended.
# Disabled controls are exempt, and text over pictures is not looked at.
CONTRAST = """() => {
    const one = document.createElement("canvas").getContext("2d", { willReadFrequently: true }), cache = new Map();
    const parse = (text) => {
        if (!cache.has(text)) {
            one.clearRect(0, 0, 1, 1);
            one.fillStyle = text;
            one.fillRect(0, 0, 1, 1);
            const [r, g, b, a] = one.getImageData(0, 0, 1, 1).data;
            cache.set(text, [r, g, b, a / 255]);
        }
        return cache.get(text);
    };
    const over = ([r, g, b, a], under) => [r, g, b].map((value, k) => a * value + (1 - a) * under[k]);
    const ground = (element) => {
        const colour = parse(getComputedStyle(element).backgroundColor);
        return colour[3] === 1 || !element.parentElement ? colour.slice(0, 3) : over(colour, ground(element.parentElement));
    };
    const linear = (value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);
    const luminance = ([r, g, b]) => 0.2126 * linear(r / 255) + 0.7152 * linear(g / 255) + 0.0722 * linear(b / 255);
    const wrong = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    const left_out = "script, template, :disabled, fieldset:disabled *, [aria-hidden=true], .cover";
    while (walker.nextNode()) {
        const element = walker.currentNode.parentElement, text = walker.currentNode.textContent.trim();
        if (!text || element.closest(left_out) || !element.checkVisibility()) continue;
        const style = getComputedStyle(element), under = ground(element), seen = over(parse(style.color), under);
        const [high, low] = [luminance(seen), luminance(under)].sort((a, b) => b - a), contrast = (high + 0.05) / (low + 0.05);
        if (contrast < (parseFloat(style.fontSize) >= 24 ? 3 : 4.5) - 0.01) wrong.push(`${contrast.toFixed(2)}: ${text.slice(0, 40)}`);
    }
    return wrong;
}"""

# Controls without a name, pictures without a description, ids that occur twice, references to ids that are not there.
NAMES = """() => {
    const wrong = [], ids = new Map();
    for (const element of document.querySelectorAll("[id]")) ids.set(element.id, (ids.get(element.id) ?? 0) + 1);
    for (const [id, count] of ids) if (count > 1) wrong.push(`id twice: ${id}`);
    for (const attribute of ["aria-labelledby", "aria-describedby", "for"]) {
        for (const element of document.querySelectorAll(`[${attribute}]`)) {
            for (const id of element.getAttribute(attribute).split(" ").filter(Boolean)) if (!ids.has(id)) wrong.push(`no such id: ${id}`);
        }
    }
    const controls = "button, a[href], input:not([type=hidden]), select, textarea, summary, canvas, img, [tabindex='0']";
    for (const element of document.querySelectorAll(controls)) {
        if (!element.checkVisibility() || element.closest("[aria-hidden=true]")) continue;
        const text = element.matches("button, a, summary, :not(input, select, textarea, canvas, img)") && element.textContent.trim();
        const given = element.getAttribute("aria-label") || element.getAttribute("aria-labelledby");
        if (!(given || text || element.labels?.length || element.alt)) wrong.push(`no name: ${element.outerHTML.slice(0, 80)}`);
    }
    return wrong;
}"""

# Things to press that are less than 44 x 44 CSS pixels, counting what their label adds; links within a line of text are exempt.
TARGETS = """() => {
    const wrong = [];
    for (const element of document.querySelectorAll("button, select, input:not([type=hidden]), a.key, summary")) {
        if (!element.checkVisibility() || element.disabled) continue;
        const boxes = [element, ...(element.labels ?? [])].map((each) => each.getBoundingClientRect());
        if (boxes[0].width < 2) continue; // out of sight: its label is pressed
        const [wide, high] = [Math.max(...boxes.map((box) => box.width)), Math.max(...boxes.map((box) => box.height))];
        const name = element.id || element.textContent.trim() || element.outerHTML.slice(0, 60);
        if (high < 43.5 || wide < 43.5) wrong.push(`${wide.toFixed(0)} x ${high.toFixed(0)}: ${name}`);
    }
    return wrong;
}"""

SIDEWAYS = "() => document.documentElement.scrollWidth > innerWidth ? [`${document.documentElement.scrollWidth} px wide`] : []"
